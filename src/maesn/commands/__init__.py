"""The commands of `maesn`, one file each: options in, a call of `maesn.api`, a summary out."""
