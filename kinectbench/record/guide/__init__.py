"""The guide: tells whoever records what is still unseen, and shows it on a page."""
