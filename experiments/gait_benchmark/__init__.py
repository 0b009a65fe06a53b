"""How good the gaits are: unseen trials, survival over disturbances (VI.A), and MuJoCo C with its own contact."""
