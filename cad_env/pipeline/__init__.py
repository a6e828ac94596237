"""What one decision runs through, one stage a file: sense, track, graph, codec, radio, merge, observe.

The stages do not know each other; `step.py` runs them in that order.
"""
