"""The paper's experiment with simulated participants, run by one command (paper, Sect. 5).

`config` says what is run, `people` who takes part, `plan` which runs there are; `runner` carries out one run with the
live system's own nodes; `campaign` carries out all of them and writes the CSV files.
"""
