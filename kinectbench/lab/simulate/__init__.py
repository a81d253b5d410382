"""Objects, scenes, camera paths, the Kinect noise model, writers of recordings."""
