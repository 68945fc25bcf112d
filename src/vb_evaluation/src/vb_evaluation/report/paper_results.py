"""The paper's scenarios and methods, and its results with 15 people (Sect. 5.8). Imported without pandas, too."""

SCENARIO_TITLES = {"room": "Room exclusion", "carpet": "Carpet exclusion", "corner": "Spot cleaning"}
METHOD_TITLES = {"nrs": "Network robot system", "robot_only": "Robot only"}
METHODS = tuple(METHOD_TITLES)  # the baseline comes last

# medians with either method, by scenario
JACCARD = {"room": (0.971, 0.974), "carpet": (0.856, 0.779), "corner": (0.878, 0.906)}
COMPLETENESS = {"room": 14 / 15, "carpet": 14 / 15, "corner": 13 / 15}  # the same for both methods
SPEED_UP = {"room": 2.8, "carpet": 2.2, "corner": 2.2}  # ratios of the mean times
BORDER_GAIN_S = {"room": 4.0, "carpet": 26.0}  # [s] by which the state Border was shorter
