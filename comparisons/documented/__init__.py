"""Settings that the source documents state, and what runs use in their place."""
