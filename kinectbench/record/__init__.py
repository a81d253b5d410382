"""Recording with a camera: devices behind one interface, and a folder that is written while frames arrive."""
