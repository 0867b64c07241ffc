"""What has changed: estimates from the difference of board and twin, and which change explains it. Pure."""
