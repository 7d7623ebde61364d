"""From one log to another: surveyed landmarks, tree features, motion from scans."""
