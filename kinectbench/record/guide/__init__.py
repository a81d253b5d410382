"""The guide: a web page that shows the person who records which parts are still unseen."""
