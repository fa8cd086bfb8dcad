"""The doctor: finds what is wrong with a graph, and says what to do about it.

`snapshot` is what a graph looks like at one moment, as plain data. `checks` finds the faults in
it, and is pure. `gathering` takes a snapshot of a running graph.
"""
