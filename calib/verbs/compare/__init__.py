"""Compare two calibrations of one robot: did it drift?"""
