"""Instruments: what sees a target, how exactly, and what it reads; a tracker and a camera behind one interface."""
