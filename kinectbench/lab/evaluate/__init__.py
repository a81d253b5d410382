"""The comparison of a simulated recording's build with the simulator's truth."""
