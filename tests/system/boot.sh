#!/bin/bash
# Boots the guest over this machine's /, read-only, with SHARE at its /guest; it runs SHARE/run.sh as root and ends.
#
#   tests/system/boot.sh "$(tests/system/prepare.sh)" SHARE SECONDS
#
# Everything the guest writes is forgotten but what it writes to /guest. Emulated (TCG): it needs no rights, no KVM, and
# is about 20 times slower than this machine. Ends with the status of QEMU, or 124 after SECONDS.
set -euo pipefail

folder=$1 share=$2 seconds=$3
exec timeout --foreground "$seconds" qemu-system-x86_64 \
    -accel tcg,thread=multi -machine q35 -cpu max -smp 2 -m 1024 -nodefaults -no-reboot -display none -serial stdio \
    -kernel "$folder/vmlinuz" -initrd "$folder/initrd.gz" \
    -append "console=ttyS0 quiet loglevel=4 panic=-1 mitigations=off random.trust_cpu=on" \
    -virtfs local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap \
    -virtfs "local,path=$share,mount_tag=share,security_model=none,multidevs=remap"
