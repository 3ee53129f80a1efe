"""Files: bounded reading, whole or not there, owned by one process, tables of text."""
