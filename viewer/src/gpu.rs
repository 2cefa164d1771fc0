//! The graphics device: Vulkan where there is one, GL otherwise.

/// A graphics device and its queue. Clones share it.
#[derive(Clone, Debug)]
pub struct Gpu {
    pub(crate) adapter: wgpu::Adapter,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
}

/// Why there is no device to draw with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// Nothing answers, neither through Vulkan nor through GL.
    #[error(
        "no graphics adapter found: install a driver, or for drawing without a GPU the package \
         mesa-vulkan-drivers (Debian, Ubuntu)"
    )]
    NoAdapter,
    /// The adapter refuses what the shaders need.
    #[error("the graphics adapter {name} gives no device")]
    NoDevice {
        /// The adapter's name.
        name: String,
        /// What it said.
        source: wgpu::RequestDeviceError,
    },
}

impl Gpu {
    /// A device without a window.
    ///
    /// GL is asked only where Vulkan has none: its libraries look for a window system and complain
    /// on stderr that there is none.
    ///
    /// # Errors
    ///
    /// Any [`GpuError`].
    pub fn headless() -> Result<Self, GpuError> {
        let ask = |backends| {
            let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
            descriptor.backends = backends;
            Self::from_instance(&wgpu::Instance::new(descriptor), None)
        };
        match ask(wgpu::Backends::VULKAN) {
            Err(GpuError::NoAdapter) => ask(wgpu::Backends::GL),
            answer => answer,
        }
    }

    /// A device of `instance` that can present to `surface`.
    ///
    /// # Errors
    ///
    /// Any [`GpuError`].
    pub(crate) fn from_instance(
        instance: &wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
    ) -> Result<Self, GpuError> {
        let backends = wgpu::Backends::VULKAN | wgpu::Backends::GL;
        let mut adapters = pollster::block_on(instance.enumerate_adapters(backends));
        adapters.retain(|adapter| surface.is_none_or(|s| adapter.is_surface_supported(s)));
        adapters.sort_by_key(preference);
        let adapter = adapters.into_iter().next().ok_or(GpuError::NoAdapter)?;

        let descriptor = wgpu::DeviceDescriptor {
            label: Some("areoid"),
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|source| GpuError::NoDevice { name: adapter.get_info().name, source })?;
        Ok(Self { adapter, device, queue })
    }

    /// Waits until the device has done what it was told so far.
    ///
    /// # Panics
    ///
    /// If the device is lost.
    pub fn wait(&self) {
        self.device.poll(wgpu::PollType::wait_indefinitely()).expect("the device answers");
    }

    /// The adapter's name and interface, for people.
    #[must_use]
    pub fn description(&self) -> String {
        let info = self.adapter.get_info();
        format!("{} ({:?})", info.name, info.backend)
    }
}

/// Real devices first, Vulkan before GL.
fn preference(adapter: &wgpu::Adapter) -> (u8, bool) {
    let info = adapter.get_info();
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    };
    (kind, info.backend != wgpu::Backend::Vulkan)
}
