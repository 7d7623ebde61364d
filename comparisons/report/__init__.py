"""What a run leaves behind: result.json, the table, pictures."""
