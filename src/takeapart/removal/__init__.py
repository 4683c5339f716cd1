"""Removal of one part: grasps, collision-free paths, and the library of everything found (Sec. IV-B)."""
