"""Aluminium-profile assemblies by the paper's procedure (Sec. VI-A), and several of them around one robot."""
