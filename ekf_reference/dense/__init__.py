"""Dense maps in local triangular regions between landmarks (Nieto 2005, chapters 3 and 4).

Information flows one way: everything here reads the filter's mean and covariance, nothing writes
them. What lies in a region keeps its local coordinates for good; where that is in the world
follows from the three base landmarks whenever it is asked.
"""
