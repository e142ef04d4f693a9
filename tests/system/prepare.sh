#!/bin/bash
# Debian packages and a kernel to a guest: writes `vmlinuz` and `initrd.gz` to the work folder, whose path it prints.
# Installs what builds the firmware and runs it in QEMU, Octave and Chromium, too.
#
#   tests/system/prepare.sh            make what is missing
#   tests/system/prepare.sh --check    only say what the guest misses
#
# The folder is $TACTABLE_SYSTEM_FOLDER, by default ~/.cache/tactable/system; what is there is used again, and several
# runs at once wait for each other. Packages are installed with apt-get, so missing ones need root on Debian 12.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
folder=${TACTABLE_SYSTEM_FOLDER:-${XDG_CACHE_HOME:-$HOME/.cache}/tactable/system}
PATH=$PATH:/usr/sbin:/sbin
# The host's / over 9p; then a virtual digitizer; then a USB device controller with a serial gadget, and its host side.
modules=(virtio_pci 9pnet_virtio 9p overlay uhid hid-generic hid-multitouch evdev dummy_hcd usb_f_acm cdc-acm)

main() {
    if [[ ${1:-} == --check ]]; then
        [[ -z $(missing_packages) ]] || fail "$(missing_packages) missing: run tests/system/prepare.sh as root on Debian"
        is_built || fail "no guest, or an old one, in $folder: run tests/system/prepare.sh on Debian"
    else
        mkdir -p "$folder"
        exec 9>"$folder/lock"
        flock 9
        scratch=$(mktemp -d "$folder/scratch.XXXXXX")
        trap 'rm -rf "$scratch"' EXIT
        install_packages
        [[ -e $folder/vmlinuz && -d $folder/modules ]] || fetch_kernel
        is_built || build_initramfs
    fi
    echo "$folder"
}

is_built() {
    [[ -e $folder/vmlinuz && $folder/initrd.gz -nt $here/init.sh && $folder/initrd.gz -nt $here/prepare.sh ]]
}

missing_packages() {
    local -A package_of=([qemu-system-x86_64]=qemu-system-x86 [busybox]=busybox-static [cpio]=cpio [modprobe]=kmod)
    local command missing=()
    for command in "${!package_of[@]}"; do
        type -P "$command" >/dev/null || missing+=("${package_of[$command]}")
    done
    echo "${missing[*]}"
}

missing_firmware_packages() {
    type -P qemu-system-arm >/dev/null || echo qemu-system-arm
    type -P make >/dev/null || echo make
    type -P cc >/dev/null || echo gcc libc6-dev
    type -P arm-none-eabi-gcc >/dev/null || echo gcc-arm-none-eabi
    # A library, of which the compiler tells the path once it is there.
    [[ $(arm-none-eabi-gcc -print-file-name=nano.specs 2>/dev/null) == /* ]] || echo libnewlib-arm-none-eabi
}

missing_octave_packages() {
    type -P octave-cli >/dev/null || echo octave
    [[ -n $(dpkg-query -W -f '${Version}' octave-netcdf 2>/dev/null) ]] || echo octave-netcdf
}

missing_browser_packages() {
    type -P chromium >/dev/null || type -P chromium-browser >/dev/null || echo chromium
}

everything_missing() {
    missing_packages
    missing_firmware_packages
    missing_octave_packages
    missing_browser_packages
}

install_packages() {
    local missing
    read -ra missing <<<"$(everything_missing | tr '\n' ' ')"
    ((${#missing[@]})) || return 0
    type -P apt-get >/dev/null || fail "${missing[*]} missing, and no apt-get to install them with: install them"
    ((EUID == 0)) || fail "${missing[*]} missing: as root, run apt-get install ${missing[*]}"
    apt-get -o Acquire::Retries=3 update -q >&2
    DEBIAN_FRONTEND=noninteractive apt-get -o Acquire::Retries=3 install -y -q --no-install-recommends "${missing[@]}" >&2 ||
        fail "apt-get does not install ${missing[*]}: see above"
    local left
    left=$(everything_missing | tr "\n" " ")
    [[ -z ${left// /} ]] || fail "apt-get installed all of ${missing[*]}, and still missing is $left"
}

# The full kernel, not -cloud: that one has no uhid. 70 MB to download, of which 12 MB are kept.
fetch_kernel() {
    type -P apt-get >/dev/null || fail "no apt-get to download a kernel with: run this on Debian"
    cd "$scratch"
    download_kernel || { update_lists && download_kernel; } || fail "apt-get downloads no linux-image-amd64: see above"
    dpkg-deb -x ./*.deb .
    local image=(boot/vmlinuz-*)
    collect_modules "${image[0]#boot/vmlinuz-}"
    rm -rf "$folder/modules"
    mv needed "$folder/modules"
    mv "${image[0]}" "$folder/vmlinuz"
    cd - >/dev/null
}

# As root, apt-get drops to a user of its own, which could not write to the scratch folder.
download_kernel() {
    local name
    name=$(apt-cache depends linux-image-amd64 2>/dev/null | sed -n 's/^ *Depends: \(linux-image-[0-9].*\)$/\1/p' | head -n 1)
    [[ -n $name ]] && apt-get download -q -o Acquire::Retries=3 -o APT::Sandbox::User=root "$name" >&2
}

update_lists() {
    ((EUID == 0)) || fail "apt-get has no fresh lists: as root, run apt-get update"
    apt-get -o Acquire::Retries=3 update -q >&2
}

# The modules and what they depend on, and the order to load them in.
collect_modules() {
    local version=$1 module path
    depmod -b . "$version"
    mkdir needed
    for module in "${modules[@]}"; do
        modprobe -d . -S "$version" --show-depends "$module" | awk '$1 == "insmod" {print $2}'
    done | awk '!seen[$0]++' | while read -r path; do
        cp "$path" needed/
        basename "$path" >>needed/order
    done
}

build_initramfs() {
    local root=$scratch/root
    mkdir -p "$root"/{bin,proc,sys,dev,host,upper,system}
    cp "$(type -P busybox)" "$root/bin/busybox"
    cp -r "$folder/modules" "$root/modules"
    install -m 755 "$here/init.sh" "$root/init"
    (cd "$root" && find . | cpio -o -H newc --quiet | gzip -1) >"$scratch/initrd.gz"
    mv "$scratch/initrd.gz" "$folder/initrd.gz"
}

fail() {
    echo "prepare.sh: $1" >&2
    exit 1
}

main "$@"
