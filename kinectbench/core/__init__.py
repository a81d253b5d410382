"""The ground: arrays, values and files, without any policy."""
