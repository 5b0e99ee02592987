"""Benchmarks: `ssmr benchmark NAME [key=value …]`, one file each, all printed and saved by table.py."""
