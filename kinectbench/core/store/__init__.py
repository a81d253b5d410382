"""Object stores and web servers by their URLs: what is read, put and listed there, and how failures read."""
