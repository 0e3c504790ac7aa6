"""Path tracing with Open Image Denoise."""
