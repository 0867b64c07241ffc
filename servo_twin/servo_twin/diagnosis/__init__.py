"""What has changed: estimates of the plant from the difference of board and twin, and which change explains it. Pure."""
