"""Methods of today: what each reads of a view, and how its output becomes a prediction. A file for each."""
