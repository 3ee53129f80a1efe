"""The first call to support: is this computer fit to run the program, and what is wrong."""
