"""Learn the dominant dynamics of continuum robots on spectral submanifolds, and control the robots with them.

Plant ─collect→ Trajectories ─train→ ReducedModel ─export→ Artifact ─→ Controller ⟲ Plant ─→ ClosedLoopRecord ─→ report

Units are SI throughout (m, s, kg, N). Observations are displacements from the rest position.
"""

__version__ = "0.7.1"
