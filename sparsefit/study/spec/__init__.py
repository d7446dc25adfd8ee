"""What a study asks: one TOML file, resolved into cases."""
