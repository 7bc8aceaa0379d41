"""Recordings in every form that is read: what a folder holds, which reader is for which file, and the readers.

Each reader fills `pipeline.formats.mcap.channels.Contents` with the poses of one recording, and
`pipeline.formats.mcap.joint_states.joint_recording` makes of these what ingest takes, in the same way for all.
"""
