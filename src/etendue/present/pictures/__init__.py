"""From a variable to a picture, and pictures side by side."""
