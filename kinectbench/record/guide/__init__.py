"""The guide: shows the person who records, on a web page, what is still unseen."""
