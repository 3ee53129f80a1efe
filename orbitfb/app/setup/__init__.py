"""What is settled before anything runs: the ring, the lease, the directories, the stored policy."""
