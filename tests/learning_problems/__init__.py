"""Experience without worlds: what baselines 4 and 5 are tested on."""
