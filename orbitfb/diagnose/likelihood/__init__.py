"""The evidence of a record: floor, healthy errors, and what any term beside them is worth."""
