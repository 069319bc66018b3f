"""`python -m maesn` is the command `maesn`."""

from maesn.cli import main

main()
