"""Object stores and web servers by URL: reading, writing, listing, and messages of failures."""
