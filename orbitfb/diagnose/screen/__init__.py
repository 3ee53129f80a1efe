"""The integrity screen: what is certain before any statistics."""
