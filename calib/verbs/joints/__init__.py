"""Compute the joint values of a table that has the flange's poses instead."""
