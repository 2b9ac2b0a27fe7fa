"""What a folder or file of raw data is: which files make a frame, what their numbers mean."""
