"""Where something moves, and what the filter ignores there."""
