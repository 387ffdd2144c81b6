"""The virtual machine on Modbus TCP and RTU: one unit id per axis, registers as mapped in `config/registers/*.yaml`."""
