"""A second StarlETH that shares no code with the model: it makes the logs that judge the diagnosis.

MuJoCo C at 0.1 ms for the bodies, NumPy for the drives, hidden effects in both, a sealed truth. Nothing here
imports the model's packages or JAX, and nothing there imports this.
"""
