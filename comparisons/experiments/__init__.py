"""Published figures, Monte Carlo studies, planted defects; nothing above imports them."""
