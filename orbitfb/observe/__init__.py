"""What people and their tools see: live status, metrics, health, log and summary."""
