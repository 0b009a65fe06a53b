"""Logs as they are read: tables of any form, columns of any name and unit, one grid of samples, their noise."""
