"""One file per figure; each function takes typed records and returns a Matplotlib figure."""
