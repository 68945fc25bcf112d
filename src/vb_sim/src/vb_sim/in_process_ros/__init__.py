"""Runs the live system's own nodes in one process and in simulated time, as fast as the processor can.

The wiring is not described a second time: a run loads the live system's launch file and starts the scripts that it
names. Only rospy, threading and time are replaced: topics and services are queues within the process, threads are tasks
that take turns, and the clock advances when all tasks wait. Nodes, rates, parameters, conversions and queues are
therefore those of the live system, and a change to any node changes the study.

Processor and network are not simulated. Delays of topics, services and functions stand for them.
"""
