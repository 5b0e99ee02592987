"""Plants: robots that the package simulates, and a robot on another computer. Each one offers what `Plant` describes.

    plant = ssmr_torch.plants.Trunk()        # silicone with eight cables, by finite elements; also Diamond
    plant = ssmr_torch.plants.SlowManifold() # analytic: its spectral submanifold is known in closed form
    plant = ssmr_torch.plants.TendonChain()  # by MuJoCo; for four more robots see docs/foreign_robots.md
    plant = ssmr_torch.plants.Rig(plant, noise_std=1e-4, sensor_delay=0.02)   # the same robot with noise and delay
    plant = ssmr_torch.plants.RemotePlant("tcp://0.0.0.0:5555")               # waits until a robot connects
"""

from typing import TYPE_CHECKING

from ssmr_torch.lazy import lazily

if TYPE_CHECKING:
    from ssmr_torch.plants.base import Plant
    from ssmr_torch.plants.cosserat_rod import CosseratRod
    from ssmr_torch.plants.diamond import Diamond
    from ssmr_torch.plants.emulated_rig import Rig
    from ssmr_torch.plants.isupport import ISupport
    from ssmr_torch.plants.planar_hsa import PlanarHSA
    from ssmr_torch.plants.pressure_arm import PressureArm
    from ssmr_torch.plants.remote_robot import RemotePlant
    from ssmr_torch.plants.slow_manifold import SlowManifold
    from ssmr_torch.plants.tendon_chain import TendonChain
    from ssmr_torch.plants.trunk import Trunk

__all__ = ["CosseratRod", "Diamond", "ISupport", "PlanarHSA", "Plant", "PressureArm", "RemotePlant", "Rig",
           "SlowManifold", "TendonChain", "Trunk"]

__getattr__, __dir__ = lazily(__name__, {
    "CosseratRod": "ssmr_torch.plants.cosserat_rod:CosseratRod", "Diamond": "ssmr_torch.plants.diamond:Diamond",
    "ISupport": "ssmr_torch.plants.isupport:ISupport", "PlanarHSA": "ssmr_torch.plants.planar_hsa:PlanarHSA",
    "PressureArm": "ssmr_torch.plants.pressure_arm:PressureArm",
    "TendonChain": "ssmr_torch.plants.tendon_chain:TendonChain", "Plant": "ssmr_torch.plants.base:Plant",
    "RemotePlant": "ssmr_torch.plants.remote_robot:RemotePlant", "Rig": "ssmr_torch.plants.emulated_rig:Rig",
    "SlowManifold": "ssmr_torch.plants.slow_manifold:SlowManifold", "Trunk": "ssmr_torch.plants.trunk:Trunk"})
