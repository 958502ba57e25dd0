"""Base: files, pictures, directions and messages; it knows nothing of fabrics."""
