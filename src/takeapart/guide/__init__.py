"""Learning from earlier plans which part to remove next (Sec. V-C to V-E)."""
