"""The protocol (docs/protocol.md) without I/O: messages, their frames, and ZeroMQ's wire protocol."""
