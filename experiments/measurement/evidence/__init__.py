"""What a log says of each part of the plant: replays on what was measured, their residuals over noise."""
