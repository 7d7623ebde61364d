"""The report as one page: no network, nothing from a log taken for markup."""
