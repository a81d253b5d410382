"""The guide: says while one records what is still unseen, and shows it on a page."""
