"""The paper's experiment with simulated participants, run by one command (paper, Sect. 5).

`config` says what is run, `people` who takes part, `methods` how they interact; `runner` carries out one run with
the pure code of the live nodes; `campaign` carries out all of them and writes the CSV files.
"""
