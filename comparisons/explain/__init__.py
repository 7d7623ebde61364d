"""What explains an estimate or its records: faults, evidences, and one search over them."""
