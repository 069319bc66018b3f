"""The commands of `maesn`: options in, a call of `maesn.api`, a summary out."""
