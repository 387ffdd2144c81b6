"""The virtual machine behind Modbus TCP and RTU: a unit id an axis, registers as `config/registers/*.yaml` map them."""
