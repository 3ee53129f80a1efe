"""When the loop acts: its pace, what it waits for and how long."""
