"""The smoother a second time, with its own matcher of scan landmarks."""
