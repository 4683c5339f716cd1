"""Pictures and animations by MuJoCo."""
