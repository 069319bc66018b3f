"""Experience without worlds: what floors 4 and 5 are tested on."""
