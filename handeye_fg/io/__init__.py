"""Files in and out: poses, cameras, images, options and results."""
