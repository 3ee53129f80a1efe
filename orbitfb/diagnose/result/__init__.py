"""What a diagnosis says: its schema, its words, its files."""
