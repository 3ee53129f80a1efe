"""What the paper's experiment leaves: table, pictures, page."""
