"""The third stage: which errors explain the measurements, and how far the answer can be trusted."""
