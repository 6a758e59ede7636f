"""Who acts: scripted policies, the learned one, how they are trained and compared, and the command line.

Only the learned policy and its training import torch and stable-baselines3, and only when they are used.
"""
