"""The stage that samples views of the object, and makes the object's mask in each."""
