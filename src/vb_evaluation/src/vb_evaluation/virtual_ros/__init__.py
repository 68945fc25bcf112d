"""Runs the live system's own nodes in one process and in simulated time, as fast as the processor can.

The one idea: nothing is wired a second time. A run loads the launch file of the live system and starts the scripts that
it names; only rospy, threading and time are replaced: topics and services are queues within the process, threads are
tasks that take turns, and the clock advances when all tasks wait. So nodes, rates, parameters, conversions and queues
are the live system's, and a change of any node is a change of the study.

Processor and network are not simulated; they are modelled as delays of topics, services and functions.
"""
