"""How far poses can be trusted."""
