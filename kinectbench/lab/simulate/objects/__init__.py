"""What is recorded: parametric furniture, and objects from mesh files."""
