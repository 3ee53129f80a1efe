"""The command line: thin; what a command needs is imported when it runs."""
