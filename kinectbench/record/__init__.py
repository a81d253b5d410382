"""Recording with a camera: devices behind one interface, and the folder that is written as frames come."""
