"""`python -m orbitfb` is the command line."""

from orbitfb.cli.app import main

main()
