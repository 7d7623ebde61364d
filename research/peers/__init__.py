"""Other programs' work beside ours: `python -m research.peers [--help]`."""
