"""The arm: kinematics, inverse kinematics, and collision kernels."""
