"""Sizes that suit a processor's cache and memory; what they are changes times, not estimates.

But for STRIP_COST: a suboptimal update that would take longer than the exact one is made exactly.
"""

STRIP = 128
"""Rows that a suboptimal global update changes together."""
STRIP_COST = 1.6
"""Processor time of an entry changed in strips over that of one of the whole matrix: 1.0 to 1.6 as
measured on 250 to 2,000 landmarks."""
WHOLE = 2048
"""States up to which a global update has all of its product in memory at once."""
FOLDED = 8
"""Rows of psi for each active state that are folded together."""
STACKED = 4096
"""Records of a trace that are stacked together, which takes a third of the memory."""
