#!/bin/busybox sh
# First process of the guest: the host's / under an overlay that forgets, the shared folder at /guest, its run.sh.
export PATH=/bin
/bin/busybox --install -s /bin
mount -t proc proc /proc
mount -t sysfs sys /sys
mount -t devtmpfs dev /dev
while read -r module; do insmod "/modules/$module"; done </modules/order
over_virtio=trans=virtio,version=9p2000.L,msize=512000
mount -t 9p -o "ro,cache=loose,$over_virtio" host /host
mount -t tmpfs tmpfs /upper
mkdir /upper/files /upper/work
mount -t overlay -o lowerdir=/host,upperdir=/upper/files,workdir=/upper/work overlay /system
mkdir -p /system/guest
mount -t 9p -o $over_virtio share /system/guest
mount -t configfs config /sys/kernel/config
mkdir -p /dev/pts /dev/shm
mount -t devpts pts /dev/pts
mount -t tmpfs shm /dev/shm
for folder in proc sys dev; do mount --move /$folder /system/$folder; done
chroot /system /bin/sh /guest/run.sh
poweroff -f
