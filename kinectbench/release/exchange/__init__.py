"""Exchange of releases with other layouts."""
