"""The answer of a diagnosis: its schema, its sentences, its files."""
