"""What operators ask of a running service, checked as a whole and done between two ticks."""
