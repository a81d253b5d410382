"""What was built of a simulated recording, measured against the simulator's truth."""
