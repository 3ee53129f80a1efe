"""`python -m orbitfb` is the command line."""

from orbitfb.cli import main

main()
