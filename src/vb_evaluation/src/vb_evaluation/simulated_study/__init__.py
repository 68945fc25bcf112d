"""The paper's experiment with simulated participants, run by one command (paper, Sect. 5).

`config` reads the configuration and draws the participants, and `run_plan` lists the runs. `live_run` carries
out one run with the live system's own nodes, and `campaign` all of them. It also writes the CSV files.
"""
