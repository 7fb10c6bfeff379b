"""How arrays lie in memory, and how kernels are launched.

Here: lanes of a vector, images into lanes and back, memory kept for the next pair, launches.
May import: Taichi and NumPy.
"""
