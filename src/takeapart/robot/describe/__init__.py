"""From a URDF alone to the description of an arm or a gripper, and what the URDF does not say."""

from takeapart.robot.describe.arm import find_arm
from takeapart.robot.describe.gripper import FoundGripper, find_gripper
from takeapart.robot.describe.home import find_home
from takeapart.robot.describe.solver import prebuilt_solver

__all__ = ["FoundGripper", "find_arm", "find_gripper", "find_home", "prebuilt_solver"]
