"""What is proved by trying for long: `make prove`. Each proof has a part in tests/ that takes seconds."""
