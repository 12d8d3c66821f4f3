"""Which reference joints are fingers, and a skeleton without them.

Some artists rig every finger, others a whole hand; fingers are a fifth of all reference joints. So joints are also judged
without them: reference fingers left out, ours folded into the hand (``--fingers off``).
"""

import re

import numpy as np

FINGER = re.compile(r"(?i:thumb|index|middle|pinky|pinkie|finger|palm)|Ring|RING|(?<![A-Za-z])ring")  # and no spring


def finger_joints(names: tuple[str, ...], joint_count: int) -> np.ndarray:
    """(J,) bool, by the artist's names; none where there are no names. The root is never a finger."""
    if len(names) != joint_count:
        return np.zeros(joint_count, bool)
    found = np.array([bool(FINGER.search(name)) for name in names])
    found[0] = False
    return found


def without_joints(joints: np.ndarray, parents: np.ndarray, gone: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """joints (J, 3), parents (J,) with parents before children, gone (J,) -> those that stay; children of a joint that is gone
    hang on the nearest joint above that stays."""
    above = parents.astype(int).copy()
    for joint in range(len(above)):
        if above[joint] >= 0 and gone[above[joint]]:
            above[joint] = above[above[joint]]
    number = np.cumsum(~gone) - 1
    return joints[~gone], np.where(above[~gone] < 0, -1, number[above[~gone]])
