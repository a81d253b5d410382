"""Foundation of all other packages: geometry, values and files, without decisions about a benchmark."""
