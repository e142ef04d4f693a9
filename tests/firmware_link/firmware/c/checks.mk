# Included by firmware_link/firmware/Makefile, whose variables it uses and whose folder it is relative to.
.PHONY: syntax

IMAGES += $(BUILD)/mps2_an385.elf $(BUILD)/mps2_four.elf $(BUILD)/stm32f405_qemu.elf

$(BUILD)/mps2_an385.elf: FLAGS = -mcpu=cortex-m3 -I$(CHECKS)
$(BUILD)/mps2_four.elf: FLAGS = -mcpu=cortex-m3 -I$(CHECKS) -DACTUATORS=4u
$(BUILD)/mps2_an385.elf $(BUILD)/mps2_four.elf: $(CHECKS)/mps2_an385/board.c $(CHECKS)/report.c $(CHECKS)/report.h
$(BUILD)/stm32f405_qemu.elf: FLAGS = -mcpu=cortex-m4 -I$(CHECKS) -DIN_QEMU
$(BUILD)/stm32f405_qemu.elf: boards/stm32f405/board.c boards/adxl345.c $(CHECKS)/report.c $(CHECKS)/report.h

# The shims declare what these boards use of their vendors' libraries: nothing is linked, nothing has run.
syntax:
	$(ARM)g++ -std=gnu++17 -Wall -Wextra -Wconversion -Werror -mcpu=cortex-m7 -mthumb -fsyntax-only -Icore -Iboards \
	    -I$(CHECKS)/shim/teensy41 boards/teensy41/board.cpp
	$(ARM)gcc $(WARNINGS) -mcpu=cortex-m0plus -mthumb -fsyntax-only -Icore -Iboards -I$(CHECKS)/shim/rp2040 \
	    boards/rp2040/board.c $(PORTED)
	$(CC) $(WARNINGS) -fsyntax-only -Icore -Iboards -I$(CHECKS)/shim/esp32 boards/esp32/board.c $(PORTED)

check: syntax
