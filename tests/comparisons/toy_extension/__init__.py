"""A whole extension in one folder: a source, a finding, a row and a figure."""
