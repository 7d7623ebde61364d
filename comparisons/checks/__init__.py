"""Do the estimates agree, with each other and with truth, and if not, through which gap?"""
