"""What the source documents' constants are, and what runs use in their place."""
