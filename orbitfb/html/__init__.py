"""What reports are made of: HTML that asks for nothing from anywhere, pictures inside it."""
