"""The live system's own nodes in one process and in simulated time, as fast as the processor goes.

The one idea: nothing is wired a second time. A run loads the launch file of the live system and starts the scripts that it
names; only what rospy, threading and time answer them is another: topics and services are queues within the process,
threads are tasks that take turns, and the clock goes on when nobody has anything to do. So nodes, rates, parameters,
conversions and queues are the live system's, and a change of any node is a change of the study.

What a processor and a network need is not simulated; it is given as delays of topics, services and functions.
"""
