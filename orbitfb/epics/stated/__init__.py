"""What PVs state of themselves beside their values, and what kind of values they hold."""
