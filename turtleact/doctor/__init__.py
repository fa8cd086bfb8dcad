"""The doctor: finds what is wrong with a graph, and says what to do about it.

The module `checks` finds the faults in a snapshot, without any I/O. The module `gathering` takes a
snapshot of a running graph.
"""
